"""A simulated robot: it sees a table through our renderer and a depth sensor's noise, and lifts true objects in MuJoCo."""
