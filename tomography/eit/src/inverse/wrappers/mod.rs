//! Reconstructors that change the maps of another one: bounds, and the region of interest from the whole sheet.
//! The methods themselves are in the modules beside this one.

pub(crate) mod loss_only;
pub(crate) mod whole_sheet;
