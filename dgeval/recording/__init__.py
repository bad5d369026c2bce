"""From a file or folder to frames: containers, messages, images, roles, transforms, pairing, trials."""
