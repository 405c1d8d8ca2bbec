"""A small learned world model, first picture and prompt -> 49 frames: a yardstick, no rival to large ones.

It learns from videos of demonstrations and the poses recorded with them; to generate it has only picture and prompt.
"""
