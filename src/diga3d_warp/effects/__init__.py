"""Choice of the effects of `config.Effects` for a scene, with evidence and cost."""
