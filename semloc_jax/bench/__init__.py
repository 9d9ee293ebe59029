"""The benchmark that anyone can run: one problem, our solver and every peer that is installed (room: bench; host).

In: nothing but a seed. Out: CPU time, success rates, memory and ratios. One file for each peer behind one protocol.
"""
