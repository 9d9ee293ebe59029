"""What a map, a camera and a frame can and cannot tell about the pose (room: analysis).

In: maps, cameras, evidence, estimates. Out: expected accuracy, ambiguity, certificates, explanations, uncertainty.
"""
