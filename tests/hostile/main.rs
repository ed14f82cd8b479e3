//! Attacks on a daemon in a separate process, by other users of the machine and by files, locks and bytes. During every
//! attack the session continues, no frame is missed, and root's `tactus stop` ends it with the source verified off.
//!
//! The tests run one after another, as root: they act as other users of this machine. On a machine that does not
//! permit this, the tests print the reason and pass; with `TACTUS_REQUIRE_ROOT=1`, `TACTUS_REQUIRE_DBUS=1` and
//! `TACTUS_REQUIRE_POLKIT=1` they fail. `TACTUS_HOSTILE=all` adds tests that take minutes.
//!
//! - **site**: a folder, a system bus with real polkit, and the daemon in it
//! - **users**: connections of other users
//! - **calls**: every call of the interfaces, with hostile arguments; **flood**: many of them at once

mod calls;
mod flood;
mod site;
mod system_bus;
mod users;

mod attacks;
mod disk;
mod files;
mod floods;
mod greetings;
