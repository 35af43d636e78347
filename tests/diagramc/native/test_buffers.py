"""Memory for records."""

from diagramc.native.buffers import BufferPool


def address_of(array):
    return array.__array_interface__["data"][0]


def test_memory_is_used_again_when_no_view_of_it_is_left():
    pool = BufferPool(10_000)
    array = pool.array((8, 3, 101))
    first, view = address_of(array), array[2, 1, :50].T[3:]
    del array
    other = pool.array((8, 3, 101))
    assert address_of(other) != first
    del view
    again = pool.array((8, 3, 100))
    assert address_of(again) == first
    assert again.shape == (8, 3, 100)
    again[:] = 1.0


def test_little_unused_memory_is_kept():
    pool = BufferPool(2_500)
    arrays = [pool.array((1_000,)) for _ in range(4)]
    arrays.clear()
    assert [memory.size for memory in pool._unused] == [1_000, 1_000]
    assert pool.array((5_000,)).size == 5_000
