"""COLMAP reconstructions: camera models, binary and text files, reading and writing."""
