"""The page that a reader opens first: one HTML file that needs nothing else, not even a network."""
