"""The causal pass, one file per stage or method. No I/O, no global state; frames in, dataclasses out."""
