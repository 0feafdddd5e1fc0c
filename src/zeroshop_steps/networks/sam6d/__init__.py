"""The pose estimation of SAM-6D: where points of an image lie on an object, and the pose that follows.

Written from Lin et al., SAM-6D, CVPR 2024; Qin et al., Geometric Transformer, CVPR 2022; Han et al., FLatten Transformer, ICCV 2023; Qi
et al., PointNet++, NeurIPS 2017; Dosovitskiy et al., ViT, ICLR 2021. Names and shapes of parameters are those of the published
checkpoint.
"""
