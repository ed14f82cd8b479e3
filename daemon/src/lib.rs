//! Who keeps watch: tactusd.
