"""Tasks, experts and rollouts in ManiSkill."""
