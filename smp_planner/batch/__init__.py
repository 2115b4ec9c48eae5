"""Planning of many scenes at once: costs, descent and checks as tensors on one device."""
