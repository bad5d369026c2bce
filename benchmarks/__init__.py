"""Measurements: what dgeval reaches, on made recordings with exact truth and on real pixels. Results in results/."""
