"""The embedded ray caster: light, shading, filtered textures, and a depth sensor's noise."""
