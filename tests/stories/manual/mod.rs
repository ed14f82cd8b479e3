//! Checks the Markdown pages of the repository against the programs: links, commands, reference pages, console blocks.
//!
//! - **pages**: the pages, their links, headings and command lines
//! - **links**: every relative link and anchor exists
//! - **commands**: every command line and every flag in a page exists in the programs
//! - **cargo_commands**: packages, tests, examples and programs in `cargo` commands exist
//! - **configuration**: the page of the configuration, with a table of numbers for each section
//! - **reference**: the generated pages agree with the programs
//! - **console**: the console blocks of README and manual run on a simulated rig

mod cargo_commands;
mod cluster;
mod commands;
mod configuration;
mod console;
mod links;
mod pages;
mod promises;
mod reference;
