"""Tasks: scene layouts, success conditions and progress, and the ManiSkill environment that runs them."""
