"""From a raw surface to a finished mesh: cleaned, closed below, framed, scaled, unwrapped, textured and published."""
