"""Random streets as many countries build them, for networks to learn from (room: simulation; host).

In: a seed. Out: scenes, views of them with exact class ids. No map: nobody localizes here.
"""
