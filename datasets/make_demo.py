"""Make the bundled demo recording: a three-fingered hand follows a box on a belt and lifts it.

There is no physics in it: hand and object move on prescribed paths, so that every pose is known
exactly. The camera is on the wrist. Its pose is not in tf; it follows from joint states and robot
description, as on most robots.

    python datasets/make_demo.py datasets/demo.mcap
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parent))

from dgeval.geometry import Array, Intrinsics, invert, pose_from_matrix
from dgeval.recording.write import (
    McapWriter,
    camera_info_message,
    compressed_depth_message,
    header,
    jpeg_message,
    message,
    pose_message,
)

from raycast import Box, Capsule, Scene, add_noise, printed, render, speckle

START_NS = 1_780_000_000_000_000_000
RATE = 15.0  # Hz, of the images
DURATION = 4.6  # s
T_CLOSE, T_LIFT = 3.2, 3.6  # s
BELT_SPEED = 0.08  # m/s, along base y
HALF = (0.045, 0.028, 0.035)  # m, half lengths of the box
CAMERA = Intrinsics(320, 240, 290.0, 290.0, 160.0, 120.0)
CAMERA_FRAME = "camera_color_optical_frame"
MINIMUM_RANGE = 0.17  # m; nearer depth is not measured
DEPTH_TOPIC = "/camera/aligned_depth_to_color/image_raw/compressedDepth"
# Base of each finger in the hand frame: x m, y m, yaw rad
FINGERS = {
    "thumb": (0.05, 0.0, np.pi),
    "index": (-0.05, 0.022, 0.0),
    "middle": (-0.05, -0.022, 0.0),
}
PROXIMAL, DISTAL, RADIUS = 0.055, 0.045, 0.009  # m, lengths of the links and their radius


def translation(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return T


def rotation(*rotvec: float) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    return T


T_HAND_CAMERA = translation(0.0, -0.085, -0.02) @ rotation(-0.30, 0, 0)


def urdf() -> str:
    """The robot description: a gantry x y z, a wrist, a palm, and three fingers of two links.

    The links of the fingers are cylinders with round ends.
    """

    def link(
        name: str, length: float | None = None, box: tuple[float, float, float] | None = None
    ) -> str:
        shapes = []
        if length is not None:
            shapes.append(
                ("0 0 " + f"{length / 2}", f'<cylinder radius="{RADIUS}" length="{length}"/>')
            )
            shapes += [(f"0 0 {z}", f'<sphere radius="{RADIUS}"/>') for z in (0.0, length)]
        if box is not None:
            shapes.append(("0 0 -0.012", f'<box size="{box[0]} {box[1]} {box[2]}"/>'))
        body = "".join(
            f'<collision><origin xyz="{o}" rpy="0 0 0"/><geometry>{g}</geometry></collision>'
            for o, g in shapes
        )
        return f'<link name="{name}">{body}</link>'

    def joint(name: str, kind: str, parent: str, child: str, xyz: str, rpy: str, axis: str) -> str:
        limit = '<limit lower="-3" upper="3" effort="10" velocity="3"/>' if kind != "fixed" else ""
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>'
        )

    parts = [
        link(n)
        for n in ("base_link", "slide_x", "slide_y", "slide_z", "wrist", "palm_link", CAMERA_FRAME)
    ]
    parts.append(link("hand_base", box=(0.12, 0.07, 0.024)))
    for name, parent, child, axis in (
        ("x", "base_link", "slide_x", "1 0 0"),
        ("y", "slide_x", "slide_y", "0 1 0"),
        ("z", "slide_y", "slide_z", "0 0 1"),
    ):
        parts.append(joint(f"gantry_{name}", "prismatic", parent, child, "0 0 0", "0 0 0", axis))
    parts.append(joint("wrist_yaw", "revolute", "slide_z", "wrist", "0 0 0", "0 0 0", "0 0 1"))
    parts.append(
        joint("hand_mount", "fixed", "wrist", "hand_base", "0 0 0", f"{np.pi} 0 0", "0 0 1")
    )
    parts.append(joint("palm_mount", "fixed", "hand_base", "palm_link", "0 0 0", "0 0 0", "0 0 1"))
    x, y, z = T_HAND_CAMERA[:3, 3]
    r, p, w = Rotation.from_matrix(T_HAND_CAMERA[:3, :3]).as_euler("xyz")
    parts.append(
        joint(
            "hand_eye", "fixed", "hand_base", CAMERA_FRAME, f"{x} {y} {z}", f"{r} {p} {w}", "0 0 1"
        )
    )
    for finger, (fx, fy, yaw) in FINGERS.items():
        parts += [link(f"{finger}_proximal", PROXIMAL), link(f"{finger}_distal", DISTAL)]
        parts.append(
            joint(
                f"{finger}_1",
                "revolute",
                "hand_base",
                f"{finger}_proximal",
                f"{fx} {fy} 0",
                f"0 0 {yaw}",
                "0 1 0",
            )
        )
        parts.append(
            joint(
                f"{finger}_2",
                "revolute",
                f"{finger}_proximal",
                f"{finger}_distal",
                f"0 0 {PROXIMAL}",
                "0 0 0",
                "0 1 0",
            )
        )
    return f'<robot name="demo">{"".join(parts)}</robot>'


def smooth(t: float, a: float, b: float) -> float:
    """0 before a, 1 after b; velocity and acceleration are zero at both ends."""
    s = float(np.clip((t - a) / (b - a), 0, 1))
    return s**3 * (10 - 15 * s + 6 * s * s)


def belt_object(t: float) -> Array:
    """T_base_object while it rides on the belt."""
    return translation(0.45, -0.16 + BELT_SPEED * t, HALF[2]) @ rotation(0, 0, 0.35)


def joints(t: float) -> dict[str, float]:
    """Joint positions at t s, m and rad.

    The gantry follows the belt and comes down, the fingers close, the hand lifts.
    """
    T_base_object = belt_object(min(t, T_CLOSE + 0.25))
    distance = 1 - smooth(t, 0.3, 2.9)
    out = {
        "gantry_x": 0.45 - 0.10 * distance,
        "gantry_y": float(T_base_object[1, 3]) - 0.04 * distance,
        "gantry_z": 0.115 + 0.33 * distance + 0.14 * smooth(t, T_LIFT, T_LIFT + 0.8),
        "wrist_yaw": 0.35 - 0.25 * distance,
    }
    closed = smooth(t, T_CLOSE, T_CLOSE + 0.3)
    for finger in FINGERS:
        out[f"{finger}_1"] = -0.35 + 0.27 * closed
        out[f"{finger}_2"] = 0.45 + 0.05 * closed
    return out


def hand_pose(q: dict[str, float]) -> Array:
    """T_base_hand."""
    return (
        translation(q["gantry_x"], q["gantry_y"], q["gantry_z"])
        @ rotation(0, 0, q["wrist_yaw"])
        @ rotation(np.pi, 0, 0)
    )


def object_pose(t: float) -> Array:
    """T_base_object: on the belt until the fingers hold it, then with the hand."""
    held = T_CLOSE + 0.25
    if t < held:
        return belt_object(t)
    T_hand_object = invert(hand_pose(joints(held))) @ belt_object(held)
    return hand_pose(joints(t)) @ T_hand_object


def scene_at(t: float, scene: Scene, box: Box) -> Scene:
    """The scene with box and fingers at t s."""
    q = joints(t)
    T_hand = hand_pose(q)
    solids: list[tuple[Box | Capsule, Array]] = [(box, object_pose(t))]
    for finger, (x, y, yaw) in FINGERS.items():
        T = T_hand @ translation(x, y, 0) @ rotation(0, 0, yaw) @ rotation(0, q[f"{finger}_1"], 0)
        solids.append(
            (Capsule(RADIUS, PROXIMAL / 2, (70, 72, 78)), T @ translation(0, 0, PROXIMAL / 2))
        )
        T = T @ translation(0, 0, PROXIMAL) @ rotation(0, q[f"{finger}_2"], 0)
        solids.append(
            (Capsule(RADIUS, DISTAL / 2, (105, 108, 115)), T @ translation(0, 0, DISTAL / 2))
        )
    return Scene(scene.table, scene.tile, solids)


def make(path: Path) -> None:
    """Write the recording."""
    rng = np.random.default_rng(7)
    table = speckle(rng, (92, 96, 100), 14)
    box = Box(HALF, [printed(rng, (170, 60, 50)) for _ in range(6)])
    base = Scene(table)
    entries: list[tuple[int, int, str, object]] = []

    def add(t: float, order: int, topic: str, value: object) -> None:
        entries.append((START_NS + round(t * 1e9), order, topic, value))

    def at(t: float) -> int:
        return START_NS + round(t * 1e9)

    def stamped(t: float, T: Array) -> object:
        return message(
            "geometry_msgs/PoseStamped",
            header=header(at(t), "base_link"),
            pose=pose_message(pose_from_matrix(T)),
        )

    add(0, 0, "/robot_description", message("std_msgs/String", data=urdf()))
    for t, event in (
        (0.0, "trial_start"),
        (T_CLOSE, "close"),
        (T_LIFT, "lift"),
        (DURATION - 0.05, "trial_end"),
    ):
        add(t, 1, "/dgeval/events", message("std_msgs/String", data=json.dumps({"event": event})))
    label = json.dumps({"event": "label", "label": "success"})
    add(DURATION - 0.1, 1, "/dgeval/events", message("std_msgs/String", data=label))
    for k in range(-5, round(DURATION * 100) + 5):
        t = k / 100
        q = joints(t)
        values = np.array(list(q.values()))
        empty = np.zeros(0)
        state = message(
            "sensor_msgs/JointState",
            header=header(at(t), ""),
            name=list(q),
            position=values,
            velocity=empty,
            effort=empty,
        )
        add(max(t, 0.0), 2, "/joint_states", state)
    T_object_grasp = invert(object_pose(T_CLOSE)) @ hand_pose(joints(T_CLOSE))
    for k in range(round(DURATION * RATE)):
        t = (k + 0.5) / RATE
        T_camera = hand_pose(joints(t)) @ T_HAND_CAMERA
        colour, depth, _ = render(scene_at(t, base, box), CAMERA, T_camera)
        colour, millimetres = add_noise(rng, colour, depth, MINIMUM_RANGE)
        add(t, 3, "/camera/color/camera_info", camera_info_message(at(t), CAMERA_FRAME, CAMERA))
        add(
            t,
            4,
            "/camera/color/image_raw/compressed",
            jpeg_message(at(t), CAMERA_FRAME, colour, 80),
        )
        add(
            t,
            5,
            "/camera/aligned_depth_to_color/image_raw/compressedDepth",
            compressed_depth_message(at(t), CAMERA_FRAME, millimetres),
        )
        grasp = object_pose(t) @ T_object_grasp
        near = float(np.linalg.norm(grasp[:3, 3] - hand_pose(joints(t))[:3, 3]))
        add(t, 6, "/dgeval/belief/grasp", stamped(t, grasp))
        add(
            t,
            7,
            "/dgeval/belief/score",
            message("std_msgs/Float64", data=float(np.exp(-near / 0.08))),
        )
        add(t, 8, "/truth/object_pose", stamped(t, object_pose(t)))
    with McapWriter(path) as writer:
        for log_ns, _, topic, value in sorted(entries, key=lambda e: (e[0], e[1])):
            writer.write(topic, log_ns, value)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
