"""Stable Diffusion and its relatives as priors, through diffusers. The weights are the user's."""
