#!/bin/sh
# robosuite 1.5.2, MuJoCo 4.0.0: the gripper files of robosuite as descriptions of a hand.
#
# robosuite puts each gripper's MJCF into a robot's, whose <compiler angle="radian"/> then holds for
# both. Taken alone, which is what a log's reader has that is given the hand's own file, 8 of 14 have no
# <compiler>, and MJCF's angles are degrees: the same numbers mean joints that hardly turn. Nothing
# warns of it. Two of the files are no MJCF for MuJoCo 4.0 at all.
#
# Seen: the fingers of the Jaco (range 0 to 1.51) turn by 1.51 degrees, 0.0264 rad; with the compiler
# put in, by 1.51 rad. The finger of the 2F-140 likewise, 0 to 0.7. robotiq_gripper_85.xml names a
# mesh twice, and xarm7_gripper.xml has an attribute of <default> that the schema does not know: both
# raise ValueError.
#
# Installs into a temporary folder; needs python3 3.11 and a package index. Exit code 0: as described.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install -q --target "$folder/lib" --no-deps robosuite==1.5.2
python3 -m pip install -q --target "$folder/lib" numpy==2.4.6 mujoco==4.0.0
PYTHONPATH="$folder/lib" python3 - "$folder/lib/robosuite/models/assets/grippers" <<'PY'
import re
import sys
from pathlib import Path

import mujoco

folder = Path(sys.argv[1])


def turns(name, joint, compiler=""):
    """The range of a joint, rad, with a compiler put in."""
    path = folder / name
    text = re.sub(r"(<mujoco[^>]*>)", r"\1" + compiler, path.read_text(), count=1)
    spec = mujoco.MjSpec.from_string(text)
    spec.modelfiledir = str(path.parent)
    return float(spec.compile().joint(joint).range[1])


for name, joint, written in (
    ("jaco_three_finger_gripper.xml", "joint_thumb", 1.51),
    ("robotiq_gripper_140.xml", "finger_joint", 0.7),
):
    alone = turns(name, joint)
    in_radians = turns(name, joint, '<compiler angle="radian"/>')
    print(f"{name}: {joint} is written {written}, turns {alone:.4f} rad, {in_radians:.4f} in radians")
    assert abs(alone - written * 3.14159265 / 180) < 1e-6
    assert abs(in_radians - written) < 1e-6
for name, why in (
    ("robotiq_gripper_85.xml", "repeated name"),
    ("xarm7_gripper.xml", "unrecognized attribute"),
):
    try:
        mujoco.MjSpec.from_file(str(folder / name)).compile()
    except ValueError as error:
        print(f"{name}: {str(error)[:120]!r}")
        assert why in str(error)
    else:
        raise AssertionError(f"{name} is read")
print("as described")
PY
