"""Training of every network that ships, from nothing but the simulator and its seeds.

`scenarios` draws plants, materials and sensors, and renders them into a cache. `samples` matches them and collects
features with their truth. `perceptron` fits a network by PyTorch; `confidence`, `refinement`, `holes` and `lumps` are
the recipes; `drawing` renders and draws on several workers; `instructions` lets every processor give the same bytes.
``python -m training`` runs what is missing, in order, and writes the manifest.
"""
