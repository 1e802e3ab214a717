"""Records of one test at several levels: whether the structure moves linearly, and from which level on it does not."""
