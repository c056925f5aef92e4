"""Assessment of a rig: `uncertainty`, `domain`, `validation`, `findings`, in this order; `diagnosis` joins them."""
