//! Exactly-once: which sequence numbers of a robot have been applied.

/// How far back out-of-order scans are told from duplicates.
pub const WINDOW_LENGTH: u64 = 1024;

/// What a window says of a sequence number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SequenceVerdict {
    /// Not applied yet.
    New,
    /// Applied before.
    Duplicate,
    /// Older than the window: cannot be told.
    TooOld,
}

/// The highest sequence number applied and which of the 1,024 up to it were.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SequenceWindow {
    /// The highest applied, `None` before the first.
    highest: Option<u64>,
    /// Ring of bits: number `n` at bit `n % 1024`.
    applied: [u64; 16],
    /// How many were applied in all.
    count: u64,
}

impl SequenceWindow {
    /// A window from its stored parts; `None` when they contradict each other: the highest number must be marked, no
    /// number below 0 may be, and the count is at least the numbers marked and at most all up to the highest.
    #[must_use]
    pub fn from_parts(highest: Option<u64>, applied: [u64; 16], count: u64) -> Option<Self> {
        let window = Self { highest, applied, count };
        let marked = applied.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
        let sound = match highest {
            None => marked == 0 && count == 0,
            Some(highest) => {
                let exists = |slot: u64| highest >= WINDOW_LENGTH - 1 || slot <= highest;
                window.bit(highest)
                    && (0..WINDOW_LENGTH).all(|slot| exists(slot) || !window.bit(slot))
                    && marked <= count
                    && count <= highest.saturating_add(1)
            }
        };
        sound.then_some(window)
    }

    /// The highest number applied.
    #[must_use]
    pub fn highest(&self) -> Option<u64> {
        self.highest
    }

    /// The ring of bits: number `n` at bit `n % 1024`.
    #[must_use]
    pub fn bits(&self) -> &[u64; 16] {
        &self.applied
    }

    /// How many numbers were applied in all.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// What is known of a number.
    #[must_use]
    pub fn verdict(&self, sequence: u64) -> SequenceVerdict {
        match self.highest {
            None => SequenceVerdict::New,
            Some(highest) if sequence > highest => SequenceVerdict::New,
            Some(highest) if highest - sequence >= WINDOW_LENGTH => SequenceVerdict::TooOld,
            Some(_) if self.bit(sequence) => SequenceVerdict::Duplicate,
            Some(_) => SequenceVerdict::New,
        }
    }

    /// Marks a number as applied if it is new, and says what it was before.
    pub fn record(&mut self, sequence: u64) -> SequenceVerdict {
        let verdict = self.verdict(sequence);
        if verdict == SequenceVerdict::New {
            if let Some(highest) = self.highest.filter(|highest| sequence > *highest) {
                // The ring moves up: the numbers between take the slots of those that fall out at its lower end.
                for step in 1..(sequence - highest).min(WINDOW_LENGTH) {
                    self.set(sequence - step, false);
                }
            }
            self.set(sequence, true);
            self.highest = Some(self.highest.map_or(sequence, |highest| highest.max(sequence)));
            // A count cannot pass the number of sequence numbers but by the last one of all.
            self.count = self.count.saturating_add(1);
        }
        verdict
    }

    fn bit(&self, sequence: u64) -> bool {
        let slot = sequence % WINDOW_LENGTH;
        self.applied[(slot / 64) as usize] >> (slot % 64) & 1 == 1
    }

    fn set(&mut self, sequence: u64, on: bool) {
        let slot = sequence % WINDOW_LENGTH;
        let bit = 1 << (slot % 64);
        let word = &mut self.applied[(slot / 64) as usize];
        *word = if on { *word | bit } else { *word & !bit };
    }
}
