"""Small descriptions for tests."""

from __future__ import annotations

from collections.abc import Sequence


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    xyz: str = "0 0 0",
    axis: str = "0 0 1",
    limits: tuple[float, float] | None = (-1.0, 1.0),
    mimic: str = "",
) -> str:
    limit = ""
    if kind in ("revolute", "prismatic") and limits is not None:
        limit = f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="100" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{limit}{mimic}</joint>'
    )


def follows(source: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{source}" multiplier="{multiplier}" offset="{offset}"/>'


def box(size: str, xyz: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision>'


def robot(joints: Sequence[str], solids: dict[str, str] | None = None) -> str:
    """A URDF of these joints and of the links that they name."""
    solids = solids or {}
    ends = [text.split(f'<{end} link="')[1] for text in joints for end in ("parent", "child")]
    names = [end.split('"')[0] for end in ends]
    links = "".join(f'<link name="{n}">{solids.get(n, "")}</link>' for n in dict.fromkeys(names))
    return f'<robot name="r">{links}{"".join(joints)}</robot>'


ARM = [
    joint("shoulder", "base_link", "upper", xyz="0 0 0.3"),
    joint("elbow", "upper", "lower", xyz="0 0 0.4"),
    joint("wrist", "lower", "flange", xyz="0 0 0.4"),
]
PADS = {
    "hand": box("0.04 0.2 0.06", "0 0 0.03"),
    "left": box("0.02 0.01 0.05", "0 0.005 0.025"),
    "right": box("0.02 0.01 0.05", "0 -0.005 0.025"),
}
# an arm with two jaws that meet in the middle, 0.11 m before the hand's frame
GRIPPER = [
    *ARM,
    joint("mount", "flange", "hand", "fixed"),
    joint("tcp_joint", "hand", "tcp", "fixed", "0 0 0.1"),
    joint("jaw", "hand", "left", "prismatic", "0 0 0.06", "0 1 0", (0.0, 0.04)),
    joint(
        "other_jaw", "hand", "right", "prismatic", "0 0 0.06", "0 -1 0", (0.0, 0.04), follows("jaw")
    ),
]
