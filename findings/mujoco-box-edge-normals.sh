#!/bin/sh
# MuJoCo 4.0.0: at a box beside an upright cylinder, its default search for several contacts
# (multiccd) gives some of them the normal of the box's other face, up to 29 degrees off the
# cylinder's radius, which is the only normal a cylinder's side has. With multiccd off all are within
# half a degree, and with nativeccd off here too.
#
# Whoever simulates a two-jaw gripper on cans meets it: the pads' edges push sideways. With multiccd
# off a convex mesh that stands on a box has one contact at a time and rocks, so nativeccd off is
# the setting that has neither fault.
#
# Seen (places of the box with its edge 1 mm inside the cylinder, turned by up to 8 degrees):
#   default: worst 29.0 degrees
#   multiccd off: worst 0.3 degrees
#   nativeccd off: worst 0.4 degrees
# Exit code 0 where that is so, 1 where the behaviour has changed.
set -eu
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/python" -m pip install -q mujoco==4.0.0 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import sys

import mujoco
import numpy as np

R, HALF, DEEP = 0.033, np.array([0.01, 0.01]), 0.001


def nearest(x, y, yaw):
    """The box's point that is nearest to the cylinder's axis, m."""
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.array([[c, -s], [s, c]])
    return T @ np.clip(T.T @ [-x, -y], -HALF, HALF) + [x, y]


def worst(flag):
    """Degrees, of the contact normal that is farthest from radial."""
    most = 0.0
    for degrees in range(-8, 9, 2):
        for y in (-0.02, -0.012, -0.004, 0.004, 0.012, 0.02):
            yaw, inside, outside = np.radians(degrees), 0.03, 0.08
            for _ in range(40):
                x = (inside + outside) / 2
                deep = np.linalg.norm(nearest(x, y, yaw)) < R - DEEP
                inside, outside = (x, outside) if deep else (inside, x)
            model = mujoco.MjModel.from_xml_string(
                f'<mujoco><option><flag {flag}/></option><worldbody><body><freejoint/>'
                f'<geom type="cylinder" size="{R} 0.05" mass="0.3"/></body>'
                f'<geom type="box" size="{HALF[0]} {HALF[1]} 0.03" pos="{inside} {y} 0"'
                f' euler="0 0 {degrees}"/></worldbody></mujoco>'
            )
            data = mujoco.MjData(model)
            mujoco.mj_forward(model, data)
            radial = nearest(inside, y, yaw)
            radial = radial / np.linalg.norm(radial)
            for k in range(data.ncon):
                cosine = min(1.0, abs(float(data.contact.frame[k][:2] @ radial)))
                most = max(most, float(np.degrees(np.arccos(cosine))))
    return most


seen = {name: worst(flag) for name, flag in (
    ("default", ""), ("multiccd off", 'multiccd="disable"'), ("nativeccd off", 'nativeccd="disable"')
)}
for name, degrees in seen.items():
    print(f"{name}: worst {degrees:.1f} degrees")
sys.exit(not (seen["default"] > 25 and seen["multiccd off"] < 1 and seen["nativeccd off"] < 15))
PY
