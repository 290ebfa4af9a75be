import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from leaflight.core.util.malloc_tuning import keep_freed_memory

def count_faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(8):
        rows = [np.ones({size}, np.float32) for _ in range({count})]
        del rows
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

{call}
count_faults()
print(count_faults())
"""


MB = 1 << 18  # float32


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators are left as they are")
@pytest.mark.parametrize(
    ("size", "count"), [(0.75, 8), pytest.param(0.75, 200, marks=pytest.mark.slow), pytest.param(300, 2, marks=pytest.mark.slow)]
)
def test_arrays_that_were_freed_are_used_again(size, count):
    """Large ones, and as many as a large page takes, in a process that keeps all alone."""
    default, kept, all_kept = (
        int(subprocess.run([sys.executable, "-c", program], check=True, capture_output=True).stdout)
        for call in ("", "keep_freed_memory()", "keep_freed_memory(whole=True)")
        for program in [FAULTS.format(call=call, size=int(size * MB), count=count)]
    )
    assert all_kept < 100 < default
    assert (kept < 100) == (size < 32)
