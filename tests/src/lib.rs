//! Stories: the whole system, told as tests.
