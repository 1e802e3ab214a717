"""Starting values of maximum-likelihood fits: parameters and states from records."""
