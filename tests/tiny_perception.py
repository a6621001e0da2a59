"""Checkpoints of depth and segmentation models in the real format, with a few thousand random numbers."""

from pathlib import Path

import torch


def write_depth_model(folder: Path) -> Path:
    """DPT for images of 32 px."""
    from transformers import DPTConfig, DPTForDepthEstimation

    with torch.random.fork_rng():
        torch.manual_seed(31)
        model = DPTForDepthEstimation(
            DPTConfig(
                hidden_size=16,
                num_hidden_layers=4,
                num_attention_heads=2,
                intermediate_size=16,
                image_size=32,
                patch_size=8,
                backbone_out_indices=[0, 1, 2, 3],
                neck_hidden_sizes=[8, 8, 8, 8],
                fusion_hidden_size=8,
                is_hybrid=False,
            )
        )
        for parameter in model.parameters():
            if parameter.ndim > 1:  # as initialised, what comes out is zero but for rounding
                torch.nn.init.normal_(parameter, std=0.2)
        model.save_pretrained(folder)
    return folder


def write_detector(folder: Path) -> Path:
    """GroundingDINO whose text model knows a few words."""
    from transformers import (
        BertConfig,
        BertTokenizer,
        GroundingDinoConfig,
        GroundingDinoForObjectDetection,
        SwinConfig,
    )

    folder.mkdir(parents=True)
    words = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", ".", "a", "vase", "green", "can"]
    BertTokenizer(vocab={word: k for k, word in enumerate(words)}).save_pretrained(folder)
    with torch.random.fork_rng():
        torch.manual_seed(32)
        GroundingDinoForObjectDetection(
            GroundingDinoConfig(
                backbone_config=SwinConfig(
                    image_size=32,
                    patch_size=4,
                    embed_dim=8,
                    depths=[1, 1, 1, 1],
                    num_heads=[1, 1, 2, 2],
                    window_size=4,
                    out_features=["stage2", "stage3", "stage4"],
                ),
                text_config=BertConfig(
                    vocab_size=len(words),
                    hidden_size=16,
                    num_hidden_layers=1,
                    num_attention_heads=2,
                    intermediate_size=16,
                    max_position_embeddings=32,
                ),
                d_model=32,
                encoder_layers=1,
                decoder_layers=2,
                encoder_attention_heads=2,
                decoder_attention_heads=2,
                encoder_ffn_dim=16,
                decoder_ffn_dim=16,
                num_queries=10,
                max_text_len=16,
            )
        ).save_pretrained(folder)
    return folder


def write_cutter(folder: Path) -> Path:
    """SAM for images of 64 px."""
    from transformers import (
        SamConfig,
        SamMaskDecoderConfig,
        SamModel,
        SamPromptEncoderConfig,
        SamVisionConfig,
    )

    with torch.random.fork_rng():
        torch.manual_seed(33)
        SamModel(
            SamConfig(
                vision_config=SamVisionConfig(
                    hidden_size=16,
                    output_channels=8,
                    num_hidden_layers=2,
                    num_attention_heads=2,
                    image_size=64,
                    patch_size=8,
                    window_size=4,
                    global_attn_indexes=[1],
                    mlp_dim=16,
                    num_pos_feats=4,
                ),
                prompt_encoder_config=SamPromptEncoderConfig(
                    hidden_size=8, image_size=64, patch_size=8, mask_input_channels=4
                ),
                mask_decoder_config=SamMaskDecoderConfig(
                    hidden_size=8,
                    mlp_dim=16,
                    num_hidden_layers=1,
                    num_attention_heads=2,
                    iou_head_hidden_dim=8,
                    attention_downsample_rate=2,
                ),
            )
        ).save_pretrained(folder)
    return folder
