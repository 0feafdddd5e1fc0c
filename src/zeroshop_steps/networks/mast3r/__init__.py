"""MASt3R: point maps, local features and their confidences of a pair of pictures.

Written from Weinzaepfel et al., CroCo v2, ICCV 2023; Wang et al., DUSt3R, CVPR 2024; Leroy et al., MASt3R, ECCV 2024; Ranftl et
al., Vision Transformers for Dense Prediction, ICCV 2021; Su et al., RoFormer, 2021. Names and shapes of parameters are those of
the published checkpoint.
"""
