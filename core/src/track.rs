//! One object's motion.
