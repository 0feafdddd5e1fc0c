"""The texture: charts, their atlas, exposure gains, and the colour of each texel from the photos."""
