"""The price of accuracy: depth and pose errors of whole pipelines against their time per frame, beside other
libraries.
"""
