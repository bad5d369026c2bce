"""The networks of the papers, with the authors' layer names, and the loading of checkpoints."""
