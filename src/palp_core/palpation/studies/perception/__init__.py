"""What the methods of perception get wrong, and what they cost: their stated bounds are held against it."""
