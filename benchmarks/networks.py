"""What TransT, TransT-M and GMFlow cost a frame on one thread, beside dgeval's own in one run.

    python -m benchmarks.networks

Weights are random: they don't change the time. Each is the median of REPEATS frames.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

from dgeval.determinism import limit_threads, set_thread_variables

set_thread_variables()

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from dgeval.config import load_config  # noqa: E402
from dgeval.networks.gmflow import GMFlow  # noqa: E402
from dgeval.networks.transt import TransT, TransTM  # noqa: E402
from dgeval.networks.transt_loop import TransTLoop  # noqa: E402
from dgeval.planning.vfas.motion_field import dis_flow  # noqa: E402
from dgeval.recording.manifest import find_trials  # noqa: E402
from dgeval.recording.trials import open_trial  # noqa: E402
from dgeval.replay.causal import replay  # noqa: E402

from benchmarks.result import table, write  # noqa: E402

DEMO = Path(__file__).parent.parent / "datasets" / "demo.mcap"
REPEATS = 9
SIZE = 320, 240  # px, of the flow's images


def seconds(once: Callable[[], object]) -> float:
    """Median time of one call, after one that isn't counted."""
    once()
    times = []
    for _ in range(REPEATS):
        before = time.perf_counter()
        once()
        times.append(time.perf_counter() - before)
    return statistics.median(times)


def tracking_seconds() -> float:
    """Median time of the model tracker in a frame of the demo."""
    config = load_config("dynamic", ("grasps.source=none",))
    trial = open_trial(find_trials([DEMO])[0], config)
    return statistics.median(step.seconds["tracking"] for step in replay(trial, config))


def main() -> None:
    limit_threads()
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 256, (60, 80, 3)).astype(np.uint8), (640, 480))
    own = tracking_seconds()
    rows = [["model tracker (demo)", f"{own * 1e3:.0f}", "1"]]
    for name, network in (
        ("TransT", TransT().eval()),
        ("TransT-M without mask", TransTM(has_mask=False).eval()),
        ("TransT-M", TransTM().eval()),
    ):
        loop = TransTLoop(network, update_iou=2.0)
        loop.start(image, (280.0, 200.0, 360.0, 280.0))
        took = seconds(lambda loop=loop: loop.step(image))
        rows.append([name, f"{took * 1e3:.0f}", f"{took / own:.0f}"])
    first, second = (np.ascontiguousarray(np.roll(cv2.resize(image, SIZE), k, 1)) for k in (0, 3))
    dis = dis_flow()
    dis_s = seconds(lambda: dis(first, second))
    flows = [["DIS, medium", f"{dis_s * 1e3:.1f}", "1", "–"]]
    for name, flow in (("GMFlow", GMFlow()), ("GMFlow with refinement", GMFlow(refine=True))):
        net = flow.eval()
        kept = net.features(first)
        both = seconds(lambda net=net: net(first, second))
        one = seconds(
            lambda net=net, kept=kept: net.match(kept, net.features(second), SIZE[1], SIZE[0])
        )
        flows.append([name, f"{one * 1e3:.0f}", f"{one / dis_s:.0f}", f"{one / both:.2f}"])
    parts = [
        "One thread. Tracking, images of 640 x 480:",
        table(["tracker", "ms a frame", "times the model tracker"], rows),
        f"Optical flow, images of {SIZE[0]} x {SIZE[1]}; the last column is what is left of the "
        "time by using a frame's features for both of its pairs:",
        table(["flow", "ms a frame", "times DIS", "of two frames' features"], flows),
    ]
    title, command = "Networks on images", "python -m benchmarks.networks"
    print(write("networks", title, command, parts).read_text())


if __name__ == "__main__":
    main()
