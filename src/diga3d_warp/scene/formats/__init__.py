"""Splat files: recognised, read and written in the formats that splats are exchanged in.

Everything here is NumPy. `read.read_splat` and `write.write_splat` are the entry points; each other module handles one
format.
"""
