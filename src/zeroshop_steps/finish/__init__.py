"""From the raw surface of a reconstruction to a product: clean, framed, scaled, textured and graded against truth."""
