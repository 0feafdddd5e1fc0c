"""BOP's files: models, scenes, targets, detections and estimated poses, checked against schemas."""
