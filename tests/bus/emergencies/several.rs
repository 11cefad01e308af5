//! Several emergencies at once, and several drives that may send them.

use servocrab::{DriveConfig, Network, bus::NetworkBuilder, drives};
use servocrab_sim::{AlState, Segment, personality};

use super::line::{At, Line, MS, Rig, emergency};

/// A coupler without a mailbox, then two drives.
fn line() -> Line {
    Line::new(
        Segment::new()
            .with(personality::coupler())
            .with(personality::akd2g())
            .with(personality::akd2g()),
    )
}

fn builder(line: &Line) -> NetworkBuilder {
    let first = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
    let second = DriveConfig::new(drives::akd2g()).axis("z");
    Network::builder()
        .link(line.wire())
        .drive(1, first)
        .drive(2, second)
}

#[test]
fn two_emergencies_at_once_in_a_bring_up_go_to_the_drive_that_sent_them_in_their_order() {
    let recorded = {
        let line = line();
        // Never reached: the count is of the drive that is armed.
        line.arm(u64::MAX, 2, &[]);
        Rig::start(builder(&line));
        line.seen()
    };
    assert!(recorded > 200, "{recorded}");
    // Steps of a prime number, so that all kinds of datagrams and both drives have their turn.
    for after in (1..=recorded).step_by(7) {
        let _at = At(after);
        let line = line();
        let both = [emergency(after), emergency(after + 1)];
        let position = 1 + (after % 2) as u16;
        line.arm(after, usize::from(position), &both);
        let mut rig = Rig::start(builder(&line));
        assert_eq!(line.al_state(1), AlState::Op);
        assert_eq!(line.al_state(2), AlState::Op);
        rig.expect(position, &both);
        rig.run_for(25 * MS);
        rig.expect(3 - position, &[]);
    }
}

#[test]
fn emergencies_of_two_drives_in_op_are_told_apart() {
    let line = line();
    let mut rig = Rig::start(builder(&line));
    let now = rig.bus.now();
    let (first, second) = ([emergency(1), emergency(2)], [emergency(3)]);
    line.inject(1, &first, now);
    line.inject(2, &second, now);
    rig.expect(1, &first);
    rig.expect(2, &second);
}
