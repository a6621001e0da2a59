"""Splat files: recognition, reading and writing of the exchange formats for 3D Gaussian splats.

Everything here is NumPy. `read.read_splat` and `write.write_splat` are the entry points; each other module
handles one format.
"""
