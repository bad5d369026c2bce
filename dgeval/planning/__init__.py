"""From grasps to commands: candidates, selection, servo, execution, schedule.

No I/O, no global state.
"""
