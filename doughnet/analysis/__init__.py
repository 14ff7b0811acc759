"""What the latents know: where they lie, when they jump, which frames go wrong."""
