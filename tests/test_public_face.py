"""The public face: every name is there, and comes from the module that defines it."""

import diga3d_warp


def test_every_public_name_is_there():
    for name in diga3d_warp.__all__:
        assert getattr(diga3d_warp, name).__name__ == name
    assert set(diga3d_warp.__all__) == set(diga3d_warp._HOMES)
    assert set(diga3d_warp.__all__) <= set(dir(diga3d_warp))


def test_unknown_name_is_an_attribute_error():
    assert not hasattr(diga3d_warp, "no_such_name")
