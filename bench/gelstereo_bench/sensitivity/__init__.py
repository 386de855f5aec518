"""How much every picked constant of the core matters: each is changed in a scratch build, and its stage
measured.
"""
