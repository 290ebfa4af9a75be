import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from leaflight.core.heap import keep_freed_memory

def count_faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        rows = [np.ones((3, 65536), np.float32) for _ in range({count})]
        del rows
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

{call}
count_faults()
print(count_faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators are left as they are")
@pytest.mark.parametrize("count", [8, 200])  # 6 and 157 MB
def test_arrays_that_were_freed_are_used_again(count):
    default, kept = (
        int(subprocess.run([sys.executable, "-c", FAULTS.format(call=call, count=count)], check=True, capture_output=True).stdout)
        for call in ("", "keep_freed_memory()")
    )
    assert kept < 100 < default
