"""What a scene calls for: measure, decide, explain and price the effects of `config.Effects`."""
