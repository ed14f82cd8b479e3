//! Forward solutions to compare with: dense and in any number format, by conjugate gradients, and a small tank to solve them
//! on. Left to others: what is measured with them.

pub(super) mod bordered;
pub(super) mod conjugate;
pub(super) mod tank;
