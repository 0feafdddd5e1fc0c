"""BOP's scores: pose errors, average recall of poses, average precision of detections."""
