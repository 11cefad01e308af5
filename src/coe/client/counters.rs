//! Which counter the next message gets. A device drops a message with the counter of the last one that it took, and there are only
//! seven counters. After a message that it never took, the next one must not get the counter of the last one taken.

use crate::coe::mailbox::Counter;

/// The counters of the messages to one device.
#[derive(Debug)]
pub(super) struct Counters {
    /// Of the message that is due.
    current: Counter,
    /// The last message that the device took may have had one of these: bits by the counters.
    taken: u8,
}

impl Default for Counters {
    fn default() -> Self {
        // The next one is the first.
        let current = (1..7).fold(Counter::FIRST, |counter, _| counter.next());
        Self { current, taken: 0 }
    }
}

impl Counters {
    /// For the next message: none that the last message taken may have had, as long as there is another.
    pub(super) fn next(&mut self) -> Counter {
        let mut next = self.current.next();
        while self.taken & bit(next) != 0 && next != self.current {
            next = next.next();
        }
        self.current = next;
        next
    }

    /// The device took the message with the counter that was given last.
    pub(super) fn taken(&mut self) {
        self.taken = bit(self.current);
    }

    /// Whether it took that, nobody knows.
    pub(super) fn perhaps_taken(&mut self) {
        self.taken |= bit(self.current);
    }
}

const fn bit(counter: Counter) -> u8 {
    1 << counter.get()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(counters: &mut Counters) -> u8 {
        counters.next().get()
    }

    #[test]
    fn counters_go_round_while_mails_are_taken() {
        let mut counters = Counters::default();
        let all = (0..9).map(|_| {
            let next = given(&mut counters);
            counters.taken();
            next
        });
        assert_eq!(all.collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6, 7, 1, 2]);
    }

    #[test]
    fn the_counter_of_the_last_mail_taken_is_passed_over() {
        let mut counters = Counters::default();
        given(&mut counters);
        counters.taken();
        let never_taken = (0..8).map(|_| given(&mut counters));
        assert_eq!(never_taken.collect::<Vec<_>>(), [2, 3, 4, 5, 6, 7, 2, 3]);
    }

    #[test]
    fn so_are_those_of_mails_that_may_have_been_taken() {
        let mut counters = Counters::default();
        for perhaps in [1, 2, 3] {
            assert_eq!(given(&mut counters), perhaps);
            counters.perhaps_taken();
        }
        let others = (0..5).map(|_| given(&mut counters));
        assert_eq!(others.collect::<Vec<_>>(), [4, 5, 6, 7, 4]);
        counters.taken();
        assert_eq!(given(&mut counters), 5);
        // Where all seven are uncertain, one must be taken again.
        for _ in 0..9 {
            counters.perhaps_taken();
            assert!((1..=7).contains(&given(&mut counters)));
        }
    }
}
