"""Inverse problems: which leaves of a scene make its trajectory match what was measured?"""
