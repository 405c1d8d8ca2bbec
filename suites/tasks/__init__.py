"""The benchmark's tasks: what stands where, when it is done, and the ManiSkill environment that runs them."""
