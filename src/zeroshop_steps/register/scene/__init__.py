"""What a registration reads and writes: images, masks, lenses, the database, the undistorted model, and the record."""
