//! Other users of this machine: connections attributed to them by the kernel and the bus.

use std::io::{self, IoSliceMut, Write};
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use rustix::net::{RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, recvmsg};

/// Accounts with more permissions on a bus than others.
const NOT_STRANGERS: [&str; 4] = ["root", "messagebus", "polkitd", "tactusd"];

/// A user other than root, with a process of that user.
#[derive(Debug)]
pub struct User {
    pub name: String,
    pub id: u32,
    group: u32,
    connector: Child,
    commands: UnixStream,
}

impl User {
    /// The first `count` ordinary accounts of this machine. A bus accepts only users with an account.
    pub fn strangers(count: usize, folder: &Path) -> Vec<Self> {
        // other users may not have access to the build folder
        let connector = folder.join("connector");
        std::fs::copy(env!("CARGO_BIN_EXE_connector"), &connector).unwrap();
        std::fs::set_permissions(&connector, std::fs::Permissions::from_mode(0o755)).unwrap();
        let accounts = std::fs::read_to_string("/etc/passwd").unwrap();
        let users: Vec<Self> = accounts
            .lines()
            .filter_map(|line| {
                let mut fields = line.split(':');
                let name = fields.next()?;
                let (id, group) = (fields.nth(1)?.parse().ok()?, fields.next()?.parse().ok()?);
                (id != 0 && !NOT_STRANGERS.contains(&name)).then_some((name, id, group))
            })
            .take(count)
            .map(|(name, id, group)| Self::new(name, id, group, &connector))
            .collect();
        assert_eq!(users.len(), count, "/etc/passwd has too few accounts");
        users
    }

    fn new(name: &str, id: u32, group: u32, connector: &Path) -> Self {
        let (commands, theirs) = UnixStream::pair().unwrap();
        let connector = Command::new(connector)
            .uid(id)
            .gid(group)
            .stdin(Stdio::from(OwnedFd::from(theirs)))
            .spawn()
            .unwrap_or_else(|error| panic!("no process of user {name} can be started: {error}"));
        Self {
            name: name.to_owned(),
            id,
            group,
            connector,
            commands,
        }
    }

    /// A command that runs as this user.
    pub fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.uid(self.id).gid(self.group);
        command
    }

    /// Connects to a socket.
    ///
    /// # Errors
    /// The system's error for this user.
    pub fn connect(&self, path: &Path) -> io::Result<UnixStream> {
        writeln!(&self.commands, "{}", path.display())?;
        let mut answer = [u8::MAX];
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut control = RecvAncillaryBuffer::new(&mut space);
        let read = recvmsg(
            &self.commands,
            &mut [IoSliceMut::new(&mut answer)],
            &mut control,
            RecvFlags::CMSG_CLOEXEC,
        )?;
        if read.bytes == 0 {
            return Err(io::Error::other(format!(
                "the process of user {} has ended",
                self.name
            )));
        }
        let passed = control.drain().find_map(|message| match message {
            RecvAncillaryMessage::ScmRights(mut passed) => passed.next(),
            _ => None,
        });
        passed
            .map(UnixStream::from)
            .ok_or_else(|| io::Error::from_raw_os_error(i32::from(answer[0])))
    }

    /// Connects to the message bus at this socket.
    ///
    /// # Errors
    /// The bus is full, or refuses this user.
    pub async fn come_to_bus(&self, socket: &Path) -> zbus::Result<zbus::Connection> {
        let stream = self.connect(socket)?;
        zbus::connection::Builder::unix_stream(stream)
            .user_id(self.id)
            .build()
            .await
    }
}

impl Drop for User {
    fn drop(&mut self) {
        let _ = self.connector.kill();
        let _ = self.connector.wait();
    }
}
