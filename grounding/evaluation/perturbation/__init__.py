"""What is done to frames before they are measured, to see how much the grounding bears.

Every perturbation is a function of frames (T, H, W, 3), masks of the gripper (T, H, W), a random generator and a
strength, and gives what is seen afterwards: the frames, and the masks of what is left to be seen of the gripper. The
same state of the generator gives the same bytes, another strength the same pattern, stronger. Strength 0 changes
nothing. None of them is used in training.
"""
