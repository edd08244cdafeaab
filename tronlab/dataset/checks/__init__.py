"""The single checks of ``tronlab.dataset.validate``; each gives one sentence a contradiction."""
