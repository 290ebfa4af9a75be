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
    for _ in range(20):
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
    ("size", "count"), [(0.75, 8), (100, 1), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0.75, 200), (300, 2)))]
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


IN_THREADS = """
import resource
import threading
import numpy as np
from leaflight.core.util.malloc_tuning import keep_freed_memory

def fill():
    for _ in range(4):
        np.ones({count}, np.float32)

{call}
fill()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
threads = [threading.Thread(target=fill) for _ in range(2)]
for thread in threads:
    thread.start()
    thread.join()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators are left as they are")
def test_threads_use_what_others_have_freed():
    """Else each of them would take as much from the system again."""
    faults = [
        int(subprocess.run([sys.executable, "-c", program], check=True, capture_output=True).stdout)
        for call in ("", "keep_freed_memory(whole=True)")
        for program in [IN_THREADS.format(call=call, count=3 * MB)]
    ]
    assert faults[1] < 200 < 700 < faults[0]
