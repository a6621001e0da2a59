"""Trains the room prior: a small latent diffusion network that inpaints synthetic rooms (`--prior room`).

    python -m training all              all of the following, as far as the recipe's schedule
    python -m training data             renders windows of the generator's situations
    python -m training train autoencoder    128 x 128 px to 16 x 16 latents and back
    python -m training latents          encodes the windows, with masks, once
    python -m training train decoder    trains the decoder further; encoded windows stay what they are
    python -m training train denoiser   the inpainting UNet with its text encoder
    python -m training train edges      a ControlNet; the other is "depth"
    python -m training curve            a plot of the losses
    python -m training export           a folder in diffusers format
    python -m training evaluate         masked PSNR and SSIM in rooms that were never trained on

All take `--work FOLDER` before the name. Each may be killed at any moment; the same command goes on from its
last checkpoint with the same losses.
"""
