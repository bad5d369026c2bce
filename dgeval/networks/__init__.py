"""The papers' networks under the authors' names of layers, and the loading of their checkpoints."""
