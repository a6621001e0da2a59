"""The bank of attention feature propagation, against Eq. 3 and 4 written out."""

import pytest
import torch

from diga3d_warp.errors import InputError
from diga3d_warp.priors.attention import AttentionBank, attend_through


def softmax_attention(query, key, value):
    return torch.softmax(query @ key.mT / query.shape[-1] ** 0.5, -1) @ value


@pytest.fixture
def qkv():
    """Queries, keys and values of four views: three references and one that reads."""
    generator = torch.Generator().manual_seed(1)
    return [torch.randn(4, 2, tokens, 8, generator=generator, dtype=torch.float64) for tokens in (5, 7, 7)]


def fill(bank, qkv, count=3, half=None, layer="a"):
    with bank.writing(half):
        return attend_through(bank, layer, *(x[:count] for x in qkv), softmax_attention)


def read(bank, qkv, half=None, layer="a"):
    with bank.reading(half):
        return attend_through(bank, layer, *(x[3:] for x in qkv), softmax_attention)


@pytest.mark.parametrize("count", [1, 3])
def test_reading_is_the_papers_blend(qkv, count):
    bank = AttentionBank(weight=0.6)
    fill(bank, qkv, count)
    query, key, value = qkv
    expected = torch.zeros_like(query[3])
    for r in range(count):
        expected += 0.6 / count * softmax_attention(query[3], key[r], value[r])
    expected += 0.4 * softmax_attention(query[3], key[3], value[3])
    torch.testing.assert_close(read(bank, qkv)[0], expected)


def test_it_is_one_softmax_over_all_references_only_if_asked(qkv):
    query, key, value = qkv
    joined = softmax_attention(query[3], *(torch.cat(list(x[:3]), 1) for x in (key, value)))
    averaged, together = AttentionBank(weight=1.0), AttentionBank(weight=1.0, joined=True)
    for bank in (averaged, together):
        fill(bank, qkv)
    assert not torch.allclose(read(averaged, qkv)[0], joined, atol=1e-2)
    torch.testing.assert_close(read(together, qkv)[0], joined)


def test_writing_and_off_change_nothing(qkv):
    bank = AttentionBank()
    own = softmax_attention(*qkv)
    assert torch.equal(attend_through(bank, "a", *qkv, softmax_attention), own)
    assert bank.size == 0
    assert torch.equal(fill(bank, qkv), own[:3])
    assert bank.size == 3 * 2 * 7 * (8 + 8) * 8


def test_weight_zero_is_the_view_itself_and_keeps_nothing(qkv):
    bank = AttentionBank(weight=0.0)
    fill(bank, qkv)
    assert bank.size == 0
    assert torch.equal(read(bank, qkv), softmax_attention(*(x[3:] for x in qkv)))


def test_halves_and_layers_are_apart(qkv):
    bank = AttentionBank()
    fill(bank, qkv, half="negative")
    fill(bank, [2.0 * x for x in qkv], half="positive")
    fill(bank, [x.flip(0) for x in qkv], half="positive", layer="b")
    single = AttentionBank()
    fill(single, qkv)
    assert torch.equal(read(bank, qkv, half="negative"), read(single, qkv))
    results = [read(bank, qkv, "negative"), read(bank, qkv, "positive"), read(bank, qkv, "positive", "b")]
    assert not torch.allclose(results[0], results[1])
    assert not torch.allclose(results[1], results[2])


def test_references_may_be_written_one_after_another(qkv):
    together, apart = AttentionBank(), AttentionBank()
    fill(together, qkv)
    for k in range(3):
        with apart.writing():
            attend_through(apart, "a", *(x[k : k + 1] for x in qkv), softmax_attention)
    assert torch.equal(read(together, qkv), read(apart, qkv))


def test_reading_what_no_reference_wrote_is_an_error(qkv):
    bank = AttentionBank()
    fill(bank, qkv)
    bank.clear()
    with pytest.raises(LookupError):
        read(bank, qkv)


class Opaque:
    """Features that only their prior understands."""

    nbytes = 7

    def __init__(self, number):
        self.number = number


def test_the_bank_does_not_look_inside_features():
    bank = AttentionBank(weight=0.5)
    left = [Opaque(2.0), Opaque(4.0)]
    with bank.writing():
        assert torch.equal(bank.attend("a", torch.ones(2, 3), left, None), torch.ones(2, 3))
    assert bank.size == 14
    with bank.reading():
        found = bank.attend("a", torch.ones(1, 3), [Opaque(9.0)], lambda of: torch.full((1, 3), of.number))
    assert torch.equal(found, torch.full((1, 3), 0.5 + 0.5 * 3.0)) and bank.size == 14


def test_weight_outside_the_range():
    with pytest.raises(InputError, match=r"attention weight 1.5 is outside"):
        AttentionBank(weight=1.5)
