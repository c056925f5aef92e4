from laspy.vlrs import known as known
