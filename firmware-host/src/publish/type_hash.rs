//! Hashes that identify message versions in ROS 2 (REP 2011).

/// RIHS01 hash of a message's description in ROS 2 Jazzy; `None` for messages that no topic uses.
#[must_use]
pub fn rihs01(name: &str) -> Option<&'static str> {
    Some(match name {
        "std_msgs/msg/String" => "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        "sensor_msgs/msg/Image" => "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
        "sensor_msgs/msg/CompressedImage" => {
            "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
        }
        "sensor_msgs/msg/PointCloud2" => {
            "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
        }
        "sensor_msgs/msg/JointState" => {
            "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
        }
        "geometry_msgs/msg/PoseStamped" => {
            "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
        }
        "geometry_msgs/msg/PoseWithCovarianceStamped" => {
            "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
        }
        "geometry_msgs/msg/WrenchStamped" => {
            "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::rihs01;
    use crate::recording::Topic;

    #[test]
    fn every_topic_has_a_hash() {
        for topic in Topic::ALL {
            assert!(rihs01(topic.schema().name).is_some(), "{}", topic.name());
        }
    }
}
