"""Search in the plane: from lanes over a phantom to whether there is a nodule, where, how deep, how sure."""
