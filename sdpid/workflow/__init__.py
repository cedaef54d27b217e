"""The whole chain in one call: recordings and a robot in, certified parameters and files out."""
