//! Numbers of the programs, procedures and flags of VXI-11 revision 1.0 (sections B.4 and B.6) and of the port mapper.

/// The port mapper (RFC 1833): program, version, the procedure that returns a port, and the protocol number of TCP.
pub(crate) const PORT_MAPPER: u32 = 100_000;
pub(crate) const PORT_MAPPER_VERSION: u32 = 2;
pub(crate) const GET_PORT: u32 = 3;
pub(crate) const TCP: u32 = 6;

pub(crate) const CORE: u32 = 0x0006_07AF;
pub(crate) const ABORT: u32 = 0x0006_07B0;
/// Version of both programs.
pub(crate) const VERSION: u32 = 1;

pub(crate) const DEVICE_ABORT: u32 = 1;
pub(crate) const CREATE_LINK: u32 = 10;
pub(crate) const DEVICE_WRITE: u32 = 11;
pub(crate) const DEVICE_READ: u32 = 12;
pub(crate) const DEVICE_READSTB: u32 = 13;
pub(crate) const DEVICE_TRIGGER: u32 = 14;
pub(crate) const DEVICE_CLEAR: u32 = 15;
pub(crate) const DEVICE_REMOTE: u32 = 16;
pub(crate) const DEVICE_LOCAL: u32 = 17;
pub(crate) const DEVICE_LOCK: u32 = 18;
pub(crate) const DEVICE_UNLOCK: u32 = 19;
pub(crate) const DEVICE_ENABLE_SRQ: u32 = 20;
pub(crate) const DEVICE_DOCMD: u32 = 22;
pub(crate) const DESTROY_LINK: u32 = 23;
pub(crate) const CREATE_INTERRUPT_CHANNEL: u32 = 25;
pub(crate) const DESTROY_INTERRUPT_CHANNEL: u32 = 26;

/// Flags of an operation: wait for a lock, the data end a message, read up to a character.
pub(crate) const WAIT_FOR_LOCK: u32 = 1;
pub(crate) const END: u32 = 8;
pub(crate) const UNTIL_CHARACTER: u32 = 128;
