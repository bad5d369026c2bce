"""The causal pass over a log: what such a system would have believed and commanded."""
