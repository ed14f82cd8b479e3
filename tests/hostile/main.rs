//! Attacks on a daemon that runs as a process of its own, by other users of the machine and by files, locks and bytes that
//! nobody meant well. Whatever is attacked: the session goes on, no frame is missed, and `tactus stop` by root ends it with
//! the source verified off.
//!
//! The tests run one after the other, as root: they act as other users of this machine, who are not asked. On a machine
//! that does not allow that they say so and end; `TACTUS_REQUIRE_ROOT=1`, `TACTUS_REQUIRE_DBUS=1` and
//! `TACTUS_REQUIRE_POLKIT=1` make it a failure. `TACTUS_HOSTILE=all` adds what takes minutes.
//!
//! - **site**: a folder, a system bus with real polkit, and the daemon in it
//! - **users**: connections that belong to other users
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
