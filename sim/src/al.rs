//! The AL state machine of a SubDevice: requests of the MainDevice, checks, refusals with an AL status code.

use core::time::Duration;

/// AL states, with the codes that the registers use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum AlState {
    /// No mailbox, no process data.
    Init = 1,
    /// Mailbox.
    PreOp = 2,
    /// Firmware download; no device of this crate has it.
    Boot = 3,
    /// Mailbox and inputs; outputs are ignored.
    SafeOp = 4,
    /// Mailbox, inputs and outputs.
    Op = 8,
}

/// Reasons of a refusal or a fall, as register 0134h gives them (ETG.1000.6).
pub(crate) mod code {
    pub(crate) const NONE: u16 = 0x0000;
    pub(crate) const INVALID_CHANGE: u16 = 0x0011;
    pub(crate) const UNKNOWN_STATE: u16 = 0x0012;
    pub(crate) const BOOT_NOT_SUPPORTED: u16 = 0x0013;
    pub(crate) const INVALID_MAILBOX: u16 = 0x0016;
    pub(crate) const NO_VALID_OUTPUTS: u16 = 0x0019;
    pub(crate) const SYNC_LOST: u16 = 0x001A;
    pub(crate) const WATCHDOG: u16 = 0x001B;
    pub(crate) const INVALID_OUTPUTS: u16 = 0x001D;
    pub(crate) const INVALID_INPUTS: u16 = 0x001E;
    pub(crate) const INVALID_WATCHDOG: u16 = 0x001F;
    pub(crate) const NO_SYNC: u16 = 0x002D;
    pub(crate) const INVALID_SYNC: u16 = 0x0030;
    pub(crate) const PLL: u16 = 0x0032;
    pub(crate) const SYNC_TIMEOUT: u16 = 0x0034;
    pub(crate) const INVALID_SYNC_CYCLE: u16 = 0x0035;
    pub(crate) const UNSUPPORTED_SYNC0_CYCLE: u16 = 0x0036;
    pub(crate) const EEPROM_ERROR: u16 = 0x0051;
}

/// Control bit 4 acknowledges an error, status bit 4 shows it.
const ERROR_BIT: u16 = 0x0010;
/// Control bit 5 asks for the explicit device identification, status bit 5 says that 0134h shows it (ETG.1020).
const ID_BIT: u16 = 0x0020;

/// What the device checks before a step up.
pub(crate) trait Checks {
    /// INIT to PREOP.
    fn mailbox(&self) -> Result<(), u16>;
    /// PREOP to SAFEOP.
    fn process_data(&self) -> Result<(), u16>;
    /// SAFEOP to OP: what is still missing, valid outputs or SYNC0.
    fn ready_for_op(&self) -> Result<(), u16>;
}

/// The state machine.
#[derive(Clone, Debug)]
pub(crate) struct AlMachine {
    state: AlState,
    code: u16,
    /// A request for OP that waits for outputs or SYNC0, and until when.
    waiting: Option<Duration>,
    /// What the explicit device identification shows, and whether the MainDevice asks for it.
    identification: Option<u16>,
    asks_who: bool,
}

impl AlMachine {
    /// After power-up.
    pub(crate) fn new(identification: Option<u16>) -> Self {
        Self {
            state: AlState::Init,
            code: code::NONE,
            waiting: None,
            identification,
            asks_who: false,
        }
    }

    /// The state now.
    pub(crate) fn state(&self) -> AlState {
        self.state
    }

    /// The AL status code; zero without error.
    pub(crate) fn code(&self) -> u16 {
        self.code
    }

    /// What the explicit device identification shows, when the device has one.
    pub(crate) fn identification(&self) -> Option<u16> {
        self.identification
    }

    /// Gives the device another identification.
    pub(crate) fn identify(&mut self, identification: u16) {
        self.identification = Some(identification);
    }

    /// Values of AL status and of 0134h: that has the error if there is one, else the identification if it is asked for.
    pub(crate) fn registers(&self) -> (u16, u16) {
        let state = u16::from(self.state as u8);
        match self.identification {
            _ if self.code != code::NONE => (state | ERROR_BIT, self.code),
            Some(id) if self.asks_who => (state | ID_BIT, id),
            _ => (state, code::NONE),
        }
    }

    /// The MainDevice wrote AL control. `patience` is how long a request for OP waits for outputs and SYNC0.
    pub(crate) fn request(
        &mut self,
        control: u16,
        checks: &dyn Checks,
        now: Duration,
        patience: Duration,
    ) {
        self.asks_who = control & ID_BIT != 0;
        let Some(requested) = decode(control) else {
            self.refuse(code::UNKNOWN_STATE);
            return;
        };
        if control & ERROR_BIT != 0 {
            self.code = code::NONE;
        } else if self.code != code::NONE && requested >= self.state {
            // While the error is not acknowledged, only a way down is looked at.
            return;
        }
        self.waiting = None;
        match (self.state, requested) {
            (AlState::Init, AlState::Boot) => self.refuse(code::BOOT_NOT_SUPPORTED),
            (_, AlState::Boot) => self.refuse(code::INVALID_CHANGE),
            (state, requested) if requested <= state => {
                self.state = requested;
                self.code = code::NONE;
            }
            (AlState::Init, AlState::PreOp) => self.step(AlState::PreOp, checks.mailbox()),
            (AlState::PreOp, AlState::SafeOp) => self.step(AlState::SafeOp, checks.process_data()),
            (AlState::SafeOp, AlState::Op) if checks.ready_for_op().is_ok() => {
                self.step(AlState::Op, Ok(()));
            }
            (AlState::SafeOp, AlState::Op) => self.waiting = Some(now.saturating_add(patience)),
            _ => self.refuse(code::INVALID_CHANGE),
        }
    }

    /// Looks whether a request for OP can be granted or has waited too long; then what is missing is the reason.
    pub(crate) fn poll(&mut self, checks: &dyn Checks, now: Duration) {
        let Some(deadline) = self.waiting else {
            return;
        };
        let check = checks.ready_for_op();
        if check.is_ok() || now >= deadline {
            self.waiting = None;
            self.step(AlState::Op, check);
        }
    }

    /// The device itself falls to a lower state with a reason.
    pub(crate) fn fall(&mut self, state: AlState, code: u16) {
        self.waiting = None;
        self.state = self.state.min(state);
        self.code = code;
    }

    fn step(&mut self, state: AlState, check: Result<(), u16>) {
        match check {
            Ok(()) => {
                self.state = state;
                self.code = code::NONE;
            }
            Err(code) => self.refuse(code),
        }
    }

    fn refuse(&mut self, code: u16) {
        self.waiting = None;
        self.code = code;
    }
}

fn decode(control: u16) -> Option<AlState> {
    Some(match control & 0x000F {
        1 => AlState::Init,
        2 => AlState::PreOp,
        3 => AlState::Boot,
        4 => AlState::SafeOp,
        8 => AlState::Op,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Answers {
        mailbox: Result<(), u16>,
        outputs: bool,
    }

    impl Checks for Answers {
        fn mailbox(&self) -> Result<(), u16> {
            self.mailbox
        }
        fn process_data(&self) -> Result<(), u16> {
            Ok(())
        }
        fn ready_for_op(&self) -> Result<(), u16> {
            if self.outputs { Ok(()) } else { Err(0x0019) }
        }
    }

    const FINE: Answers = Answers {
        mailbox: Ok(()),
        outputs: true,
    };
    const PATIENCE: Duration = Duration::from_millis(100);

    /// Writes AL control and returns AL status and status code.
    fn ask(machine: &mut AlMachine, control: u16, checks: &Answers) -> (u16, u16) {
        machine.request(control, checks, Duration::ZERO, PATIENCE);
        machine.registers()
    }

    #[test]
    fn it_goes_up_step_by_step_and_down_in_one() {
        let mut machine = AlMachine::new(None);
        assert_eq!(ask(&mut machine, 2, &FINE), (2, 0));
        assert_eq!(ask(&mut machine, 4, &FINE), (4, 0));
        assert_eq!(ask(&mut machine, 8, &FINE), (8, 0));
        assert_eq!(ask(&mut machine, 1, &FINE), (1, 0));
    }

    #[test]
    fn a_skipped_state_is_an_invalid_change() {
        let mut machine = AlMachine::new(None);
        assert_eq!(ask(&mut machine, 8, &FINE), (0x11, 0x0011));
    }

    #[test]
    fn unknown_states_and_boot_are_refused_with_codes_of_their_own() {
        assert_eq!(ask(&mut AlMachine::new(None), 7, &FINE), (0x11, 0x0012));
        assert_eq!(ask(&mut AlMachine::new(None), 3, &FINE), (0x11, 0x0013));
    }

    #[test]
    fn an_error_blocks_the_way_up_until_it_is_acknowledged() {
        let mut machine = AlMachine::new(None);
        let bad = Answers {
            mailbox: Err(0x0016),
            outputs: true,
        };
        assert_eq!(ask(&mut machine, 2, &bad), (0x11, 0x0016));
        assert_eq!(ask(&mut machine, 2, &FINE), (0x11, 0x0016));
        assert_eq!(ask(&mut machine, 0x11, &FINE), (1, 0));
        assert_eq!(ask(&mut machine, 2, &FINE), (2, 0));
    }

    #[test]
    fn op_waits_for_outputs_and_is_refused_when_none_come() {
        let silent = Answers {
            mailbox: Ok(()),
            outputs: false,
        };
        let mut machine = AlMachine::new(None);
        ask(&mut machine, 2, &FINE);
        ask(&mut machine, 4, &FINE);
        assert_eq!(ask(&mut machine, 8, &silent), (4, 0));
        machine.poll(&silent, Duration::from_millis(99));
        assert_eq!(machine.registers(), (4, 0));
        machine.poll(&silent, PATIENCE);
        assert_eq!(machine.registers(), (0x14, 0x0019));
        assert_eq!(ask(&mut machine, 0x14, &silent), (4, 0));
        assert_eq!(ask(&mut machine, 8, &silent), (4, 0));
        machine.poll(&FINE, Duration::ZERO);
        assert_eq!(machine.registers(), (8, 0));
    }
}
