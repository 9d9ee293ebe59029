"""Maps the way the literature makes them, as baselines beside ours (room: mapping; host).

In: a drive, its masks, chain and gauge. Out: LiteratureMap: poses, loops and a map of points.
The way from wheels and gyroscope, the graph and its robust loops are ours for all of them: what differs is what they
see, how they find loops and what they accept as one.
"""
