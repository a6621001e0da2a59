"""Cases of masks, orientation and photographs."""
