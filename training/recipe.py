"""The recipe: every size, share and rate of the training, with its reason."""

from __future__ import annotations

from dataclasses import dataclass

VERSION = 1
"""Of data and networks. Checkpoints and data of another version are refused: raise it with any change of
`DataRecipe`, of the networks' sizes, or of the vocabulary."""


@dataclass(frozen=True)
class DataRecipe:
    """What is rendered.

    Attributes:
        side: Of a window [px]. Objects of captures of 160 to 320 px width span 50 to 140 px.
        first_seed: Seed of the first room to train on. Benchmarks use small seeds, so rooms from here on are
            never among theirs.
        held_out_seed, held_out_rooms: Seed of the first room that is kept from training, and their number.
        tested_seed: Seed of the first of these for published figures; the others are looked at while the
            recipe is worked on.
        windows: Windows of each room, as many views apart. Lighting a room takes 2 to 5 s and a window
            0.1 to 0.2 s, so fewer would waste the light, and more would show the same again.
        recasts: Materials in which each of a room's two objects is shown in each window.
        suited: Share of materials that suit the shape, as those of the generator do; others are any of the
            vocabulary, so that the network learns what each word of a prompt says.
        tinted: Share of materials with a colour, as in "dark green marble".
        plain_solids: Share of rooms whose other object is a cube, cylinder, cone or sphere.
        around: Least and largest side of a window [sides of the object's box]. Priors are given windows of
            1.6; further away, objects are too small to tell.
        aside: How far an object lies from the middle of its window, at most [sides of the window].
        supersampling: Rays per pixel and axis, those of the generator.
        cameras: Views of a room among which the windows are spread.
    """

    side: int = 128
    first_seed: int = 10_000
    held_out_seed: int = 9_000
    held_out_rooms: int = 100
    tested_seed: int = 9_020
    windows: int = 16
    recasts: int = 3
    suited: float = 0.4
    tinted: float = 0.2
    plain_solids: float = 0.4
    around: tuple[float, float] = (1.2, 2.4)
    aside: float = 0.15
    supersampling: int = 2
    cameras: int = 24


@dataclass(frozen=True)
class SampleRecipe:
    """How the networks are shown a window.

    Attributes:
        blurred: Share of images that are made as blurred as those of a small capture [1].
        enlarged: Most that those are enlarged [1].
    """

    blurred: float = 0.5
    enlarged: float = 2.0


@dataclass(frozen=True)
class RunRecipe:
    """How one network is trained.

    Attributes:
        batch: Samples of a step. Small ones for small hours: the noise of a gradient costs less than the
            steps that larger batches would leave undone.
        rate: Learning rate of AdamW, constant between `warm_up` and `cooling`; the mean of the weights takes
            the place of a decaying rate meanwhile, so that any checkpoint may be used.
        warm_up: Steps of the rise to it.
        cooling: Last share of the steps, over which it falls to nothing. More steps go on at the full rate
            (warm-up, stable, decay: Hu et al. 2024).
        average: Decay per step of the mean of the weights (EMA), less in the first steps.
        decay: Weight decay.
        most: Largest norm of a gradient; larger ones are scaled down.
    """

    batch: int
    rate: float
    warm_up: int = 200
    cooling: float = 0.2
    average: float = 0.999
    decay: float = 0.01
    most: float = 1.0

    def rate_at(self, step: int, steps: int) -> float:
        """Learning rate of a step of a training that ends after a number of them."""
        rise = (step + 1) / self.warm_up
        fall = (steps - step) / max(self.cooling * steps, 1.0)
        return self.rate * min(1.0, rise, fall)


@dataclass(frozen=True)
class AutoencoderRecipe:
    """The autoencoder, diffusers' AutoencoderTiny: convolutions only, so 0.9 M weights are fast on a CPU.

    Attributes:
        channels: Of all layers.
        blocks: Residual blocks at each size below the first.
        latent_channels: Of a latent cell of 8 x 8 px. With 4, patterns of the size of a cell are lost.
        gradients: Weight of differences between neighbouring pixels beside the pixels' own: keeps edges.
        noise: Added to latents before they are decoded [their deviation]: the decoder then bears the errors
            of a denoiser.
        spread: Weight that keeps each latent channel at mean 0 and deviation 1.
        greyed: Share of images that are greyed out under a mask, as the denoiser is given them [1].
        crop: Side of the parts of windows that it is trained on [px]: four times the steps of whole windows.
        run: Its training.
    """

    channels: int = 64
    blocks: int = 1
    latent_channels: int = 8
    gradients: float = 1.0
    noise: float = 0.1
    spread: float = 0.01
    greyed: float = 0.25
    crop: int = 64
    run: RunRecipe = RunRecipe(batch=8, rate=8e-4)


@dataclass(frozen=True)
class MaskRecipe:
    """What is masked: shares of the forms, which sum to 1, and sizes.

    Attributes:
        of_object: With an object: its silhouette, its box, its and the other object's silhouette, a free
            form, everything. Of everything the network generates.
        of_place: Without: an object's silhouette, both objects', a free form, everything.
        grown: Most that a silhouette is grown [px]: masks of captures are dilated, and cover some surround.
        shadows: Share of rooms without object whose known part shows the object's shadow, as captures do.
    """

    of_object: tuple[float, ...] = (0.55, 0.2, 0.1, 0.1, 0.05)
    of_place: tuple[float, ...] = (0.6, 0.1, 0.25, 0.05)
    grown: int = 8
    shadows: float = 0.6


@dataclass(frozen=True)
class PromptRecipe:
    """What is said of an image.

    Attributes:
        forms: Shares of forms for an object: with its place, alone, "made of", material only, shape only;
            they sum to 1. Of an object something is always said: with a tenth unsaid, every fifth removal
            had one.
        unsaid_places: Share of rooms without object of which nothing is said: without a prompt the network
            continues the surroundings, and guidance leads away from these.
        synonyms: Share of shapes that another word stands for.
    """

    forms: tuple[float, ...] = (0.27, 0.39, 0.12, 0.13, 0.09)
    unsaid_places: float = 0.5
    synonyms: float = 0.3


@dataclass(frozen=True)
class TextRecipe:
    """Tokenizer and text encoder, trained along with the denoiser.

    Attributes:
        tokens: Longest prompt; the longest of the training has 34.
        width: Of an embedding.
        layers: Of self-attention: "dark green" has to be told from "green".
    """

    tokens: int = 40
    width: int = 128
    layers: int = 2


@dataclass(frozen=True)
class LatentRecipe:
    """Encoded samples.

    Attributes:
        places: Share of samples without object [1].
        other_edges: Share of objects whose edges are those of their shape in another material [1].
        chunk: Samples that are encoded and written together.
    """

    places: float = 0.45
    other_edges: float = 0.5
    chunk: int = 64


@dataclass(frozen=True)
class DenoiserRecipe:
    """The inpainting UNet.

    Attributes:
        channels: At 16 x 16, 8 x 8 and 4 x 4 cells. The coarse level sees the whole window and costs little.
        attention: Whether each level attends to itself and to the prompt; the middle does, too.
        head: Width of an attention head.
        groups: Of group normalisation.
        snr: Signal-to-noise ratio from which on the weight of a noise level no longer rises (Hang et al.
            2023, plus 1: by the ratio alone, levels that are nearly noise would hardly count, and it is there
            that the network learns to continue the surroundings).
        known: Weight of cells outside the mask, which the network is given and only has to copy.
        run: Its training.
    """

    channels: tuple[int, ...] = (64, 128, 160)
    attention: tuple[bool, ...] = (True, True, False)
    head: int = 32
    groups: int = 16
    snr: float = 5.0
    known: float = 0.2
    run: RunRecipe = RunRecipe(batch=24, rate=6e-4)


@dataclass(frozen=True)
class ControlRecipe:
    """A ControlNet: the UNet's way down without attention, since the UNet itself reads the prompt.

    Attributes:
        embedding: Channels of the layers that bring a control image to the size of latents.
        run: Its training.
    """

    embedding: tuple[int, ...] = (16, 32, 64, 96)
    run: RunRecipe = RunRecipe(batch=24, rate=6e-4)


@dataclass(frozen=True)
class ScheduleRecipe:
    """How far `python -m training all` goes; in all about 12 hours of two quiet cores with AMX.

    Attributes:
        rooms, held_out_rooms: Rendered; 3.5 s each.
        autoencoder: Steps; 5 a second. The text tells of polka dots only if latents do.
        samples: Encoded; 50 a second.
        denoiser: Steps; 2.5 a second.
        controls: Steps of each ControlNet; 2.5 a second.
    """

    rooms: int = 600
    held_out_rooms: int = 20
    autoencoder: int = 40_000
    samples: int = 120_000
    denoiser: int = 60_000
    controls: int = 10_000


@dataclass(frozen=True)
class Recipe:
    """All of it.

    Attributes:
        seed: Of weights, order of samples and noise.
        data: What is rendered.
        samples: How the networks are shown it.
        autoencoder: The autoencoder and its training.
        masks, prompts, text: What a denoiser is given beside the image.
        latents: How samples are encoded.
        denoiser, control: The networks, and their training.
        schedule: How far each stage goes.
        every: Time between two checkpoints [s].
        shown: Processor time between two pictures [s]; those of the denoiser take half a minute.
    """

    seed: int = 0
    data: DataRecipe = DataRecipe()
    samples: SampleRecipe = SampleRecipe()
    autoencoder: AutoencoderRecipe = AutoencoderRecipe()
    masks: MaskRecipe = MaskRecipe()
    prompts: PromptRecipe = PromptRecipe()
    text: TextRecipe = TextRecipe()
    latents: LatentRecipe = LatentRecipe()
    denoiser: DenoiserRecipe = DenoiserRecipe()
    control: ControlRecipe = ControlRecipe()
    schedule: ScheduleRecipe = ScheduleRecipe()
    every: float = 180.0
    shown: float = 900.0


RECIPE = Recipe()
