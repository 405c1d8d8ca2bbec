"""Trajectories whose truth is known by proof, to hold the audit against, and the benchmark of its speed."""
