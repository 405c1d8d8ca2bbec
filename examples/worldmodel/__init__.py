"""A small learned world model, first picture and prompt -> 49 frames: a yardstick, no rival to large ones."""
