"""A diffusion prior whose noise estimates are exact: every pixel is drawn from one normal distribution.

Its prompts are the means of that distribution. Sampling, inversion and score distillation have closed forms
for it, so that the loops can be checked without weights.
"""

import torch
import torch.nn.functional as F

from diga3d_warp.priors.attention import attend_through
from diga3d_warp.priors.conditioning import Conditioning, Prompts
from diga3d_warp.priors.schedule import Schedule


def dot_attention(query, key, value):
    return torch.softmax(query @ key.mT / query.shape[-1] ** 0.5, -1) @ value


class GaussianPrior:
    """Pixels N(mean, spread^2) in [-1, 1]; the mean is the prompt.

    Args:
        spread: Standard deviation of a pixel.
        attention: How much of what its one self-attention sees is added to the estimate.
        mask_aware: Whether known pixels are told to the model, which here means that it ignores them.
        blur: Side of the box filter that encodes: latents then see beyond their own pixel.
        factor: Image pixels per latent pixel.
    """

    name = "gaussian"
    learned = True

    def __init__(self, spread=0.3, attention=0.0, mask_aware=True, blur=1, factor=1, device="cpu"):
        self.spread, self.attention, self.mask_aware = spread, attention, mask_aware
        self.blur, self.factor = blur, factor
        self.device = torch.device(device)
        self.schedule = Schedule.scaled_linear()
        self.bank = None
        self.calls = []

    def native_size(self, height, width):
        return height // self.factor, width // self.factor

    def encode_image(self, images):
        z = images.permute(0, 3, 1, 2) * 2.0 - 1.0
        return z if self.blur == 1 else F.avg_pool2d(z, self.blur, 1, self.blur // 2)

    def decode_latent(self, z):
        return (z.permute(0, 2, 3, 1) + 1.0) / 2.0

    def encode_prompts(self, positive, negative, task):
        return Prompts(float(positive or 0.0), float(negative or 0.0))

    def conditioning(self, images, masks):
        return Conditioning(self.encode_image(images), masks[:, None].float())

    def embed_images(self, images):
        return None

    def install_attention(self, bank):
        self.bank = bank

    def predict_noise(self, z, t, text, cond=None, controls=(), image_embeds=None):
        self.calls.append((len(z), t, text, 0 if self.bank is None else self.bank.size))
        alpha = self.schedule.alpha(t)
        noise = (1.0 - alpha) ** 0.5 * (z - alpha**0.5 * text)
        noise = noise / (alpha * self.spread**2 + 1.0 - alpha)
        for control in controls:
            noise = noise + control.scale * control.image[:, None]
        if self.attention and self.bank is not None:
            tokens = z.flatten(2).mT
            seen = attend_through(self.bank, "pixels", tokens, tokens, tokens, dot_attention)
            noise = noise + self.attention * seen.mT.reshape(z.shape)
        return noise

    def fill(self, image, mask, *, seed=0, depth=None):
        raise NotImplementedError
