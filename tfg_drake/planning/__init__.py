"""Planning: information gain, roadmap, chance constraint, path and its follower."""
