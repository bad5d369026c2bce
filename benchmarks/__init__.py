"""Measurements of dgeval on synthetic recordings with exact truth and on real images.

The tables go to results/.
"""
