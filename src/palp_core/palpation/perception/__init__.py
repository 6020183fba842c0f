"""From torque and EMG to a nodule's depth: pure functions and frozen values, usable in a notebook.

Torque: :mod:`wavelet`, :mod:`features`, :mod:`primitives` with :mod:`likelihoods`, :mod:`bayes`,
:mod:`information`, :mod:`stopping`. Errors that stay in a trial: :mod:`latent`, with :mod:`offsets` and
:mod:`policies_informed`; many trials at once: :mod:`stopping_batch`, :mod:`policies_batch`. EMG: :mod:`emg`,
:mod:`levels`, :mod:`markov`, :mod:`policies`, with the published strategy in :mod:`figure5`, found by
:mod:`isospectral`. The experiment: :mod:`plan` is its order, :mod:`summary` runs it dry, :mod:`statistics`,
:mod:`resampling`, :mod:`anova` and :mod:`mixed_logit` read its results, :mod:`optimal` says what would be
best.
"""
