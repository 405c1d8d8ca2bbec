"""Closed loop: from generated video to commands, execution, success and attribution."""
