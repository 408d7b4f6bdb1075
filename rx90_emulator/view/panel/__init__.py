"""The part of the page that does something: jogs joints, sends lines, asks the nodes, changes a friction element.

It speaks to the nodes by their public topics and services alone, through `Operator`, which has a thread of its own.
"""
