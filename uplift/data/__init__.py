"""The data container, its checks, splits and tensors."""
