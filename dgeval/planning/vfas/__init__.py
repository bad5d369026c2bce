"""VFAS-Grasp: sampling, scoring, motion field and filter."""
