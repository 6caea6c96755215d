"""Where to go next and how: information gain, roadmap, chance constraint, path and its follower."""
