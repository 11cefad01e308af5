//! Whether another program has EtherCAT on an interface. Two masters on one line reset each other's devices, and neither can
//! distinguish the other's process data from its own.

use std::{
    fs::{self, File},
    io,
    os::{
        fd::{AsFd, OwnedFd},
        unix::fs::MetadataExt,
    },
};

use super::ETHERTYPE;

/// The packet sockets of the network namespace that this thread is in (packet(7)): their protocol, their interface, their inode.
const SOCKETS: &str = "/proc/thread-self/net/packet";

/// Whether another socket than this one, which is bound, takes the EtherCAT frames of this interface. Of two that look at the same
/// time each sees the other. Where the system does not list its sockets, none is found.
pub(super) fn is_taken(socket: &OwnedFd, interface: libc::c_int) -> io::Result<bool> {
    let own = File::from(socket.as_fd().try_clone_to_owned()?)
        .metadata()?
        .ino();
    let sockets = fs::read_to_string(SOCKETS).unwrap_or_default();
    Ok(holders(&sockets, interface).any(|inode| inode != own))
}

/// The inodes of the sockets that take EtherCAT frames of this interface. Who receives frames of every protocol captures them, and is
/// no master.
fn holders(sockets: &str, interface: libc::c_int) -> impl Iterator<Item = u64> + '_ {
    // sk RefCnt Type Proto Iface R Rmem User Inode
    sockets.lines().filter_map(move |line| {
        let mut fields = line.split_whitespace().skip(3);
        let protocol = u16::from_str_radix(fields.next()?, 16).ok()?;
        let bound_to: libc::c_int = fields.next()?.parse().ok()?;
        let inode = fields.nth(3)?.parse().ok()?;
        (protocol == ETHERTYPE && bound_to == interface).then_some(inode)
    })
}

#[cfg(test)]
mod tests {
    use super::holders;

    /// As Linux 6.1 writes it: a master on interface 3, one on 4, a capture on 3, a socket that is not bound yet, and something newer.
    const TOLD: &str = "\
sk               RefCnt Type Proto  Iface R Rmem   User   Inode
000000008e539550 3      3    88a4   3     1 0      0      58674 
000000008e539551 3      3    88a4   4     1 0      1000   58675 
000000008e539552 3      3    0003   3     1 0      0      58676 
000000008e539553 3      3    88a4   0     0 0      0      58677 
000000008e539554 3      3    88a4   3
";

    #[test]
    fn of_all_packet_sockets_those_count_that_take_ethercat_frames_of_the_interface() {
        assert_eq!(holders(TOLD, 3).collect::<Vec<_>>(), [58674]);
        assert_eq!(holders(TOLD, 4).collect::<Vec<_>>(), [58675]);
        assert_eq!(holders(TOLD, 5).count(), 0);
        assert_eq!(holders("", 3).count(), 0);
    }
}
