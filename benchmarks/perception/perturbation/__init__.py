"""Perturbations of frames, to measure the robustness of the grounding.

Every perturbation is a function of frames (T, H, W, 3), masks of the gripper (T, H, W), a random generator and a
strength. It returns perturbed frames and the masks of the pixels that still show the gripper. The same state of the
generator gives the same bytes; another strength gives the same pattern, stronger. Strength 0 changes nothing.
Training uses other programs, for similar degradations.
"""
