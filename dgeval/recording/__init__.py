"""From recordings to frames: containers, messages, images, roles, transforms, pairing, trials."""
