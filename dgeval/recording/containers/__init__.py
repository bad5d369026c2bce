"""Files as recordings: one file per format, one face for all of them."""
