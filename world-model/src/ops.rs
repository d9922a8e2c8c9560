//! Tensor operations that the stock library is slow at, each with its exact gradient.
