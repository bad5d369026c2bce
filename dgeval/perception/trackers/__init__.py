"""Trackers of the target in the image: one file each."""
