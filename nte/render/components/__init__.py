"""Light separated at the first hit, with the vectors and gradients of its parts."""
