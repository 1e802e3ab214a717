"""Everything that is only about the paper: its published numbers, figures, Table 2 and claims."""
