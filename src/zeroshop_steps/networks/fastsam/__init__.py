"""FastSAM: masks of everything in an image, by one pass of a convolutional network.

Zhao et al., Fast Segment Anything, 2023; its network is YOLOv8x-seg with one class. Written from the paper, from YOLACT (Bolya et al.,
ICCV 2019) for the masks, from Generalized Focal Loss (Li et al., NeurIPS 2020) for the boxes, and from the names and shapes of the
published parameters.
"""
