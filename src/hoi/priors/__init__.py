"""Commonsense priors: how large an object is and where people touch it [paper 3.3]."""
