//! Digital inputs and outputs and the touch probes: named bits of CiA 402-2.

use bitflags::bitflags;

bitflags! {
    /// Digital inputs (object 60FDh). Bits 16 to 31 are the manufacturer's.
    ///
    /// ```
    /// use servocrab::ds402::DigitalInputs;
    /// let inputs = DigitalInputs::from_bits_retain(0x0001_0004);
    /// assert!(inputs.contains(DigitalInputs::HOME_SWITCH));
    /// assert!(!inputs.intersects(DigitalInputs::NEGATIVE_LIMIT_SWITCH | DigitalInputs::POSITIVE_LIMIT_SWITCH));
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct DigitalInputs: u32 {
        /// Bit 0, negative limit switch.
        const NEGATIVE_LIMIT_SWITCH = 1 << 0;
        /// Bit 1, positive limit switch.
        const POSITIVE_LIMIT_SWITCH = 1 << 1;
        /// Bit 2, home switch.
        const HOME_SWITCH = 1 << 2;
        /// Bit 3, interlock.
        const INTERLOCK = 1 << 3;
    }
}

bitflags! {
    /// Physical outputs (object 60FEh:1; the same bits in the mask 60FEh:2 enable them). Bits 16 to 31 are the manufacturer's.
    ///
    /// ```
    /// use servocrab::ds402::DigitalOutputs;
    /// assert_eq!(DigitalOutputs::SET_BRAKE.bits(), 1);
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct DigitalOutputs: u32 {
        /// Bit 0, set brake.
        const SET_BRAKE = 1 << 0;
    }
}

bitflags! {
    /// Touch probe function (object 60B8h).
    ///
    /// ```
    /// use servocrab::ds402::TouchProbeFunction;
    /// let once = TouchProbeFunction::ENABLE_1 | TouchProbeFunction::POSITIVE_EDGE_1;
    /// assert_eq!(once.bits(), 0x0011);
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct TouchProbeFunction: u16 {
        /// Bit 0, touch probe 1 enabled.
        const ENABLE_1 = 1 << 0;
        /// Bit 1, touch probe 1: each event; else the first one only.
        const CONTINUOUS_1 = 1 << 1;
        /// Bit 2, touch probe 1: the encoder's zero pulse; else the probe's input.
        const ZERO_PULSE_1 = 1 << 2;
        /// Bit 3, touch probe 1: the source that 60D0h:1 names.
        const OTHER_SOURCE_1 = 1 << 3;
        /// Bit 4, touch probe 1: samples at the positive edge.
        const POSITIVE_EDGE_1 = 1 << 4;
        /// Bit 5, touch probe 1: samples at the negative edge.
        const NEGATIVE_EDGE_1 = 1 << 5;
        /// Bit 8, touch probe 2 enabled.
        const ENABLE_2 = 1 << 8;
        /// Bit 9, touch probe 2: each event; else the first one only.
        const CONTINUOUS_2 = 1 << 9;
        /// Bit 10, touch probe 2: the encoder's zero pulse; else the probe's input.
        const ZERO_PULSE_2 = 1 << 10;
        /// Bit 11, touch probe 2: the source that 60D0h:2 names.
        const OTHER_SOURCE_2 = 1 << 11;
        /// Bit 12, touch probe 2: samples at the positive edge.
        const POSITIVE_EDGE_2 = 1 << 12;
        /// Bit 13, touch probe 2: samples at the negative edge.
        const NEGATIVE_EDGE_2 = 1 << 13;
    }
}

bitflags! {
    /// Touch probe status (object 60B9h).
    ///
    /// ```
    /// use servocrab::ds402::TouchProbeStatus;
    /// let status = TouchProbeStatus::from_bits_retain(0x0003);
    /// assert!(status.contains(TouchProbeStatus::POSITIVE_STORED_1));
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct TouchProbeStatus: u16 {
        /// Bit 0, touch probe 1 is enabled.
        const ENABLED_1 = 1 << 0;
        /// Bit 1, touch probe 1: 60BAh holds the position of a positive edge.
        const POSITIVE_STORED_1 = 1 << 1;
        /// Bit 2, touch probe 1: 60BBh holds the position of a negative edge.
        const NEGATIVE_STORED_1 = 1 << 2;
        /// Bit 8, touch probe 2 is enabled.
        const ENABLED_2 = 1 << 8;
        /// Bit 9, touch probe 2: 60BCh holds the position of a positive edge.
        const POSITIVE_STORED_2 = 1 << 9;
        /// Bit 10, touch probe 2: 60BDh holds the position of a negative edge.
        const NEGATIVE_STORED_2 = 1 << 10;
    }
}
