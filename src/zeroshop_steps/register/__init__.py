"""Registration: cameras and sparse points from the images of one capture, undistorted and checked for consistency."""
