"""Catches: contact normals that throw a can out of a jaw, after a change of engine or flags."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dgeval.geometry import Array
from dgeval.worlds.objects import ten_objects
from dgeval.worlds.scene import build

RADIUS = 0.033  # m, of an upright cylinder about the origin
HALF = np.array([0.006, 0.011])  # m, of a box, level


def nearest(x: float, y: float, yaw: float) -> Array:
    """(2,) the box's point that is nearest to the cylinder's axis."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s], [s, c]])
    return np.asarray(R @ np.clip(R.T @ [-x, -y], -HALF, HALF) + [x, y])


@pytest.mark.parametrize("y", [-0.02, -0.012, -0.004, 0.004, 0.012, 0.02])
@pytest.mark.parametrize("degrees", [-6.0, -3.0, -1.0, 0.0, 2.0, 5.0, 8.0])
def test_the_normal_at_a_boxs_edge_is_the_cylinders(degrees: float, y: float) -> None:
    """Against the closed form: the normal of a cylinder is radial, whatever the box's faces are."""
    yaw = np.radians(degrees)
    inside, outside = 0.03, 0.08
    for _ in range(40):  # the box's x at which it is 1 mm deep
        x = (inside + outside) / 2
        deep = np.linalg.norm(nearest(x, y, yaw)) < RADIUS - 0.001
        inside, outside = (x, outside) if deep else (inside, x)
    text = (
        "<mujoco><worldbody><body><freejoint/>"
        f'<geom type="cylinder" size="{RADIUS} 0.05" mass="0.3"/></body>'
        f'<geom type="box" size="{HALF[0]} {HALF[1]} 0.022" pos="{inside} {y} 0"'
        f' euler="0 0 {degrees}"/></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags = build(ten_objects()["cup"], robot="none").opt.disableflags
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    radial = nearest(inside, y, yaw) / np.linalg.norm(nearest(inside, y, yaw))
    for contact in range(data.ncon):
        normal = data.contact.frame[contact][:3]
        assert abs(float(normal[:2] @ radial)) > np.cos(np.radians(15.0))
