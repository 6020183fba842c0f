"""From torque and EMG to a nodule's depth: pure functions and frozen values, usable in a notebook.

``signal`` cleans a sweep and reads its feature; ``emg`` makes envelopes, bursts and levels of co-contraction;
``belief`` turns readings into probabilities of the depths and says when to stop; ``strategy`` chooses where
to probe next, as humans do or as is best; ``statistics`` reads the results of an experiment. What decides a
trial decides many side by side by the same lines.
"""
