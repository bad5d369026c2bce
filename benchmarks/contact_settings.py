"""What time step and friction cone of the physics do to grasps that are known to hold.

`python -m benchmarks.contact_settings`: each setting closes on and lifts the ten objects with their
first eight shipped grasps. The grasps were found at the settings in use, so every other one starts
at a small disadvantage. Time steps divide the control period of 10 ms.
"""

from __future__ import annotations

import time

import mujoco
from dgeval.determinism import limit_threads
from dgeval.simulation import grasps
from dgeval.worlds.objects import ten_objects

from benchmarks.result import table, write

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
DISABLED = {
    "multiccd": mujoco.mjtDisableBit.mjDSBL_MULTICCD,
    "nativeccd": mujoco.mjtDisableBit.mjDSBL_NATIVECCD,
    "nothing": 0,
}
SETTINGS = (  # cone, impratio, time step s, what is off; the second is the one in use
    ("elliptic", 10, 0.001, "nativeccd"),
    ("elliptic", 10, 0.002, "nativeccd"),
    ("elliptic", 10, 0.005, "nativeccd"),
    ("elliptic", 1, 0.002, "nativeccd"),
    ("pyramidal", 10, 0.002, "nativeccd"),
    ("pyramidal", 1, 0.002, "nativeccd"),
    ("elliptic", 10, 0.002, "multiccd"),
    ("elliptic", 10, 0.002, "nothing"),
)
EACH = 8  # grasps of an object


def lifted(cone: str, impratio: float, step: float, off: str) -> tuple[int, int]:
    """How many of the known grasps lift their object with these settings, and of how many."""
    good = tried = 0
    for target in ten_objects().values():
        world = grasps.FlyingHand(target)
        option = world.model.opt
        option.timestep, option.impratio, option.cone = step, impratio, CONES[cone]
        option.disableflags = int(DISABLED[off])
        for grasp in grasps.known_grasps(target)[:EACH]:
            world.put_palm(grasp.T_object_palm, grasp.preshape)
            good += world.lifts(grasp.preshape)
            tried += 1
    return good, tried


def main() -> None:
    limit_threads()
    rows = []
    for cone, impratio, step, off in SETTINGS:
        start = time.process_time()
        good, tried = lifted(cone, impratio, step, off)
        seconds = time.process_time() - start
        settings = [cone, f"{impratio:g}", f"{step * 1e3:g}", off]
        rows.append([*settings, f"{good}/{tried}", f"{seconds:.1f}"])
    head = ["cone", "impratio", "time step ms", "off", "lifted", "CPU s"]
    write(
        "contact-settings",
        "Contact settings and known grasps",
        "python -m benchmarks.contact_settings",
        [table(head, rows)],
    )


if __name__ == "__main__":
    main()
